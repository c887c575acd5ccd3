"""What the commands of all layers share: arguments, texts, exit codes and progress."""
