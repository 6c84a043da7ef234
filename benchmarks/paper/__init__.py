"""The paper's tables on rendered scenes: a queue of small trainings, one JSON record for each, and what they say."""
