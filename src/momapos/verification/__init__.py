"""Exact checks of a finished plan, independent of how it was found."""
