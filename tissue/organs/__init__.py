"""Organs that a thread can pierce: an elastic body at rest or in motion, or points fixed in space."""
