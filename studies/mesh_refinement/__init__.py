"""Which numbers of a pulled suture converge, and at which order?"""
