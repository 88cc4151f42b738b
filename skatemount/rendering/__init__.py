"""Films, and pictures of their moments."""
