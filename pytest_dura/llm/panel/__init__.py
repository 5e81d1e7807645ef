"""Panel of the player: what a component thought."""
