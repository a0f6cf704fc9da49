"""What joins the organ to itself within a step: surfaces that touch, with and without friction."""
