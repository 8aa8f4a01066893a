"""The paper's examples, reproduced: what it prints, and what its own equations give."""
