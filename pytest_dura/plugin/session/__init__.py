"""What a session has once: its evidence, inputs, workers, progress and terminal."""
