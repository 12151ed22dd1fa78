"""Values at vertices, out of what was traced at them and inside their triangles."""
