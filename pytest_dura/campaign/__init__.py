"""From scenario files to cases to episode specs."""
