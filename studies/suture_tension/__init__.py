"""How far are two holes drawn together, and up to which tension is a linear organ valid?"""
