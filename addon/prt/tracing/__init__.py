"""What a point sees: sets of directions, rays, what needs none, and transfer vectors."""
