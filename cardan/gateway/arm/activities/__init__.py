"""What an arm can be doing, one at a time. Supervision and limits are never an activity's."""
