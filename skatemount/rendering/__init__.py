"""Films and filmstrips."""
