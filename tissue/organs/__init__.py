"""Organs that a thread may pierce: an elastic body at rest or in motion, or points fixed in space."""
