"""Errors, devices, memory and text."""
