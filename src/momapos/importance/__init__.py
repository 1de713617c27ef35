"""Importance: which objects of a room matter for a task with one of them."""
