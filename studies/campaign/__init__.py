"""Many realistic scenarios, drawn at random from a seed, and how each of them ended."""
