"""A scene from recordings, and a map that robots share."""
