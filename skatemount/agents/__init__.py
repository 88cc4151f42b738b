"""Trained policies: loading, what they see and do, growing and joining them."""
