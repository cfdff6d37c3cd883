-- States are floating-point numbers, which do not compress: the attempt alone takes 1 ms for 75 kB.
ALTER TABLE snapshots ALTER COLUMN content SET STORAGE EXTERNAL;
ALTER TABLE kept_snapshots ALTER COLUMN content SET STORAGE EXTERNAL;
