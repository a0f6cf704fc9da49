"""What is the effect of prestretch and stiffening of skin on the forces that close a wound?"""
