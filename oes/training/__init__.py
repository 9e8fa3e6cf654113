"""Training shared by all networks: the loop, its optimizers, checkpoints, tensors on disk."""
