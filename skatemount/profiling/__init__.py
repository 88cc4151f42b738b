"""Speed of a training, and the parts that limit it."""
