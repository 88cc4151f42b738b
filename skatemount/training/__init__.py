"""The training loop, and chains of stages."""
