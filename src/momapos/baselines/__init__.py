"""Other ways to choose base poses, judged by the same checks as ours."""
