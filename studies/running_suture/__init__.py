"""How far along a running suture does a pull act, and does this agree with a measurement?"""
