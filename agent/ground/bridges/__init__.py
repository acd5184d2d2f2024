"""Running fleets for programs that speak other languages: translations, each with a process of its own."""
