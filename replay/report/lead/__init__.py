"""What a report leads with, and the page of a recording shows as well: what came of a run, and the tank from above."""
