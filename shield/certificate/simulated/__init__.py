"""The shield that knows what the traffic will do: verification by simulation."""
