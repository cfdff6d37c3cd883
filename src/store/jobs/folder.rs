//! The identity of the folder with the files of jobs. A worker and each node of a cluster compare
//! it, so that all of them use the same folder.

use crate::store::pool::{reading, writing};
use crate::store::{Store, StoreError};

impl Store {
    /// The identity of the service's folder.
    ///
    /// # Errors
    /// The database fails.
    pub async fn job_folder(&self) -> Result<Option<String>, StoreError> {
        let id = reading!(&self.pool, pool => {
            sqlx::query_scalar("SELECT id FROM job_folder").fetch_optional(pool).await
        });
        id.map_err(StoreError::database("reading which folder has the files of jobs"))
    }

    /// Stores the identity of the service's folder.
    ///
    /// # Errors
    /// The database fails.
    pub async fn set_job_folder(&self, id: &str) -> Result<(), StoreError> {
        let set = writing!(&self.pool, pool => {
            let sql = "INSERT INTO job_folder (one, id) VALUES (1, $1)
                       ON CONFLICT (one) DO UPDATE SET id = excluded.id";
            sqlx::query(sql).bind(id).execute(pool).await.map(drop)
        });
        set.map_err(StoreError::database("storing which folder has the files of jobs"))
    }
}
