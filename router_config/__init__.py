"""Base settings of Zenoh sessions, as data: agent.session lays over them what differs from process to process."""
