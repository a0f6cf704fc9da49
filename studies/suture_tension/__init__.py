"""How far are two holes drawn together, and up to which tension may a linear organ say so?"""
