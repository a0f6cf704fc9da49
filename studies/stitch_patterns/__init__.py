"""Which pull on the first throw closes a wound under tension, stitch by stitch?"""
