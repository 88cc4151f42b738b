"""Actor and critic."""
