"""An episode to look at and to play with in the browser."""
