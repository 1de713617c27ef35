"""Rooms in the formats of other programs: read into ours, and written from ours."""
