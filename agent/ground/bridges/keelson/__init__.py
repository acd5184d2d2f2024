"""A fleet as entities of keelson, a vocabulary for Zenoh at sea."""
