"""Which force closes a wound of a given length and width, stitch by stitch?"""
