"""Who finds the forces of the highest quality, how close to the best, and how fast."""
