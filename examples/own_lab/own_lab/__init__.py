"""A lab's own terms for skatemount."""
