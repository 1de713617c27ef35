"""Pictures of scenes and answers."""
