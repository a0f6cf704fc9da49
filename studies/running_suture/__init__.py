"""How far along a running suture is a pull felt, and is that what was measured?"""
