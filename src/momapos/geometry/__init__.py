"""Frames, boxes, footprints and grids: geometry without robots or rooms."""
