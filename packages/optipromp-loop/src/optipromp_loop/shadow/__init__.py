"""The shadow: a picker's recording, and what our planner would have done, pick by pick."""
