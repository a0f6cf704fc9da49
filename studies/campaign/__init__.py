"""Many realistic scenarios, drawn at random from a seed, and the end of each of them."""
