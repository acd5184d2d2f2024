"""What a scene looks like from anywhere, and what that is worth on photographs that were held back."""
