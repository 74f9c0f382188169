"""Learned models, linear in their structure, and the interface of dynamics models for planners."""
