"""Where a surface lies in the plane: charts, and the atlas that they are packed into."""
