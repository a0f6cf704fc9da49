"""At which force and drawn length does a suture near the edge of a strip hold, and how far is the tissue stretched?"""
