"""What does one system buy over the staggered variant and the linear step?"""
