"""Why a proposal was refused, found out again from what the decision was made from, when somebody asks."""
