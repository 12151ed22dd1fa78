"""Between Blender and arrays: scene and world in, attributes, nodes and light out."""
