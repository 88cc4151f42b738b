"""A lab's own terms, task and robot for skatemount."""
