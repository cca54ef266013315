"""Conformance of an arm's action server of FollowJointTrajectory."""
