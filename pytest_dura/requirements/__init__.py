"""What a component must do, and how episodes and campaigns are judged by it."""
