"""Which images show the front of a thing, and what that front looks like seen straight on."""
