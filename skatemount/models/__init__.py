"""Actor and critic networks."""
