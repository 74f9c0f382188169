"""What is particular to parking, driving, the highway and the roundabout."""
