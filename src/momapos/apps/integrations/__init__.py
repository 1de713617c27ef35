"""Adapters for task planners: a stream for PDDLStream, base poses for pycram.

Neither planner is imported; the adapters are an iterator and a callable.
"""
