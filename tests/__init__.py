"""The tests, in the folders of what they test, with the helpers they share."""
