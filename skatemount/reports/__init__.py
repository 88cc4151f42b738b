"""HTML pages about runs: everything that a page shows is inside it."""
