"""How many unknowns and seconds does a hole's compliance take on three kinds of meshes?

The meshes are uniform, graded and adaptive.
"""
