"""Readers: recordings of rooms, and what other programs found in them."""
