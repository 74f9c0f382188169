"""Explanations of refused proposals, computed on request from the data of the decision."""
