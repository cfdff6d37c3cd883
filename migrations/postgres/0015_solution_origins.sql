-- What computed solutions: the program's version, and the configuration by its hash.
CREATE TABLE solution_origins (
    key                BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    version            TEXT NOT NULL,
    configuration_hash TEXT NOT NULL,
    UNIQUE (version, configuration_hash)
);

-- Key of the origin; NULL where the content names it, as it did in earlier layouts. Each commit
-- stores the origins that it names, so no foreign key is checked.
ALTER TABLE solutions ADD COLUMN origin BIGINT;
