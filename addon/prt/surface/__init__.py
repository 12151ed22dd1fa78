"""Where on a mesh light is looked at: points, places inside triangles, and what bodies they are."""
