"""The robot of this example."""
