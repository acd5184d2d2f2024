"""How far the focus peak moves when frames are enhanced."""
