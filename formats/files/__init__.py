"""Files as commands treat them: outputs that are whole or not there, inputs that stay the same."""
