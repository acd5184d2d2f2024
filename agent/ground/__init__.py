"""What people hold in their hands: orders to robots, a page to stand at."""
