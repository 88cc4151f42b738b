"""A learning algorithm, a network, a callback, a logger and a curriculum outside of the package."""
