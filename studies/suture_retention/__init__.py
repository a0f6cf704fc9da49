"""At which force and drawn length does a suture near the edge of a strip hold?

How far is the tissue then stretched?
"""
