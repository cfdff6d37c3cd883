-- The tables that the migration before has copied.
DROP TABLE solutions;
DROP TABLE former_epochs;
