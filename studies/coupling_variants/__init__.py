"""What are the benefits of one system over the staggered variant and the linear step?"""
