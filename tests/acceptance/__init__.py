"""What people do with all of Cardan, done by programs: at the page, at rosbridge, in a lab."""
