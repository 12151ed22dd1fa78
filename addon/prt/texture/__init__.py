"""Values in textures: which texels, where their rays start, what is between them, and seams."""
