"""Trained policies: loading, what they read and what their actions mean, transfer, and switching between two."""
