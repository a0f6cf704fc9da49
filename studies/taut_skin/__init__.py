"""What does skin that is stretched and stiffens change of the forces that close a wound in it?"""
