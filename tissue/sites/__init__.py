"""Sites of threads on the organ: footprints, their rows over the unknowns, and checks against too
coarse meshes.
"""
