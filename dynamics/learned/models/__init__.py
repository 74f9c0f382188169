"""What is learned: models that are linear in their structure, and what else a planner may ask."""
