"""What programs for robot learning call what an arm tells and is told."""
