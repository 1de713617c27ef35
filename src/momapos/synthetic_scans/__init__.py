"""Renders scans of scenes that are known: to try the stages with, and to measure them."""
