"""What a thread may pierce: an elastic organ at rest or in motion, or points fixed in space."""
