"""Protocols of Universal Robots: RTDE, dashboard server, primary interface, URScript."""
