"""Episodes: capture of a split in the simulator, and the card that describes it."""
