"""Cook-Torrance specular by split sum: the BRDF, its table and prefiltered radiance."""
