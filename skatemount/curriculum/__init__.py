"""Curricula: which initial states are practiced, and when."""
