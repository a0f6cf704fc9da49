"""How many unknowns and seconds does a hole's compliance take on uniform, graded and adaptive meshes?"""
