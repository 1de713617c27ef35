"""Rooms: the scene record, scene files, importers and built-in kitchens."""
