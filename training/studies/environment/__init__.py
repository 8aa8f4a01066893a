"""How fast and how sound the environment is: what docs/environment.md says in numbers."""
