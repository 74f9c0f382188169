"""The input of a decision: a scene on a road, or a parking lot."""
