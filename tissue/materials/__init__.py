"""Strain-energy densities W(F) of soft tissue, with first Piola stress P = ∂W/∂F and tangent A =
∂²W/∂F².
"""
