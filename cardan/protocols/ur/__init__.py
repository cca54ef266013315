"""Universal Robots: RTDE, the dashboard server, the primary interface and URScript."""
