"""What one reads off an accepted step: the energy audit and the observations of every piercing."""
