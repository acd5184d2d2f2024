"""Push and depth step under the three control laws."""
