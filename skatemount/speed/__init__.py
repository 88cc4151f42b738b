"""How fast training is, and what of: the measurements behind `python -m skatemount.bench`."""
