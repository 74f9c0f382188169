"""What a decision is made from: a scene on a road, or a parking lot."""
