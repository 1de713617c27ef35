"""Answers as task planners ask for them: streams of PDDLStream, poses of pycram.

Neither planner is imported: what they take is an iterator and a callable.
"""
