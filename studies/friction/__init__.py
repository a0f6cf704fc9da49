"""Which pull draws a thread through rough holes?"""
