"""Light that surfaces pass on to each other: what rays meet, and what comes back from there."""
